/PROG  A	Macro
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "P[1] X = 5 mm";
CREATE		= DATE 23-07-09  TIME 09:02:48;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
/MN
   1:  UFRAME_NUM=1 ;
   2:  UTOOL_NUM=1 ;
   3:J P[1] 100% CNT100 ACC100 TB    .10sec,P-SPS    ;
   4:L P[2] 500mm/sec FINE     ;
   5:L P[3] 250cm/min CNT50 COORD    ;
   6:  DO[1]=ON ;
/POS
P[1]{
   GP1:
	UF : 0, UT : 1,		<0|gun|wobj0>
};
P[2]{
   GP1:
	UF : 1, UT : 1,		<1|gun|fixture>
};
P[3]{
   GP1:
	UF : 1, UT : 1,		<2|gun|fixture>
};
/END
